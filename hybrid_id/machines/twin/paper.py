"""What the paper prints: its tables 1 to 12 in SI units, by the names that the twins use.

Bahrami, Keshmiri, Keshmiri and Taghirad, "Identifying a two linked robot with non-symmetrical modified friction and
Backlash-flexibility models". Units are those of the reading notes: P_m1 is printed in mN m/V, P_m2 is V s/rad. Of the
parameters that Tables 6, 7 and 10 call by the motor (f_11m2), the name is kept; J_m,g is J_m here.
"""

from typing import NamedTuple


class Variation(NamedTuple):
    """One row of Tables 2, 4, 6, 7 and 10.

    Attributes:
        percent: std/mean over the experiments [%]; 0 where an earlier stage holds the parameter.
        best: value in the selected set; None where the print is cut.
    """

    percent: float
    best: float | None


class Fit(NamedTuple):
    """One row of Tables 3, 5, 8, 9 and 11, of the selected set over all experiments.

    Attributes:
        mean: average fit [%].
        std: its standard deviation [%].
        percent: std/mean [%].
    """

    mean: float
    std: float
    percent: float


GEAR_RATIO = (156.0, 84.0)

#: Motor constants of the data sheets.
TABLE_1 = {"P_m1m1": 19.059e-3, "P_m2m1": 0.0254, "P_m1m2": 42.62e-3, "P_m2m2": 0.0107}

#: Link 1, rigid: 10 experiments, test 3 selected.
TABLE_2 = {
    "J": Variation(16.345, 1.97e-5),
    "P_m1": Variation(6.436, 19.249e-3),
    "P_m2": Variation(6.888, 0.025),
    "f_11": Variation(3.590, 0.010),
    "f_12": Variation(7.742, 0.030),
    "f_13": Variation(8.402, 10.541),
    "f_14": Variation(11.688, 53.005),
    "f_21": Variation(5.071, 0.010),
    "f_22": Variation(6.998, 0.031),
    "f_23": Variation(6.666, 11.313),
    "f_24": Variation(8.857, 58.093),
    "f_3": Variation(5.760, 5.04e-5),
}
TABLE_3 = {"q_m1": Fit(93.38, 5.08, 5.44), "v_m1": Fit(95.29, 2.16, 2.26)}

#: Link 1, flexible with backlash: test 3 selected; f_3 contradicts Table 2, from which it is said to be held.
TABLE_4 = {
    "J_m": Variation(23.16, 1.32e-5),
    "J_a": Variation(22.0, 0.090),
    "P_m1": Variation(0.0, 19.25e-3),
    "P_m2": Variation(0.0, 0.025),
    "f_a1": Variation(9.34, 0.0063),
    "f_a2": Variation(8.65, 0.0056),
    "k": Variation(4.32, 380.16),
    "alpha": Variation(6.65, 0.31),
    "beta": Variation(8.09, 169.34),
    "f_11": Variation(7.65, 0.0089),
    "f_12": Variation(2.32, 0.0285),
    "f_13": Variation(15.83, 12.52),
    "f_14": Variation(13.0, 59.53),
    "f_21": Variation(8.75, 0.0081),
    "f_22": Variation(2.45, 0.030),
    "f_23": Variation(13.29, 14.10),
    "f_24": Variation(8.99, 63.73),
    "f_3": Variation(0.0, 6.94e-5),
}
TABLE_5 = {"q_m1": Fit(92.64, 4.93, 5.32), "v_m1": Fit(94.26, 3.46, 3.67)}

#: Link 2 at high velocity, joint 1 held: 8 experiments, test 3 selected.
TABLE_6 = {
    "P_2": Variation(2.62, 0.135),
    "f_11m2": Variation(5.64, 0.0024),
    "f_12m2": Variation(3.18, 0.0103),
    "f_13m2": Variation(10.49, 17.74),
    "f_14m2": Variation(6.07, 113.17),
    "f_21m2": Variation(8.99, 0.0029),
    "f_22m2": Variation(4.04, 0.0097),
    "f_23m2": Variation(5.52, 17.95),
    "f_24m2": Variation(5.03, 108.30),
}

#: Link 2 at low velocity, joint 1 held: 9 experiments, test 3 selected; f_11m2 and f_21m2 are not in it.
TABLE_7 = {
    "P_2": Variation(29.36, 0.185),
    "f_12m2": Variation(1.76, 0.0111),
    "f_13m2": Variation(20.70, 28.54),
    "f_14m2": Variation(11.28, 125.96),
    "f_22m2": Variation(1.57, 0.0112),
    "f_23m2": Variation(23.65, 19.28),
    "f_24m2": Variation(21.75, 91.07),
}
TABLE_8 = {"q_m2": Fit(86.13, 9.24, 10.73), "v_m2": Fit(96.18, 1.02, 1.06)}
TABLE_9 = {"q_m2": Fit(82.76, 4.04, 4.88), "v_m2": Fit(83.05, 2.20, 2.65)}

#: Both links: 12 experiments, test 7 selected; f_3m1 is printed as "2.932E-".
TABLE_10 = {
    "f_11m1": Variation(24.11, 0.011),
    "f_12m1": Variation(4.430, 0.038),
    "f_13m1": Variation(12.93, 10.182),
    "f_14m1": Variation(13.62, 51.088),
    "f_21m1": Variation(29.25, 0.023),
    "f_22m1": Variation(8.300, 0.039),
    "f_23m1": Variation(10.48, 16.318),
    "f_24m1": Variation(18.08, 41.463),
    "f_3m1": Variation(11.57, None),
    "f_12m2": Variation(2.49, 0.010),
    "f_13m2": Variation(12.14, 24.146),
    "f_14m2": Variation(12.70, 114.718),
    "f_22m2": Variation(2.80, 0.011),
    "f_23m2": Variation(27.10, 25.934),
    "f_24m2": Variation(12.45, 97.418),
    "P_1": Variation(23.18, 1.101),
    "P_2": Variation(10.69, 0.136),
    "P_3": Variation(15.00, 0.148),
    "P_4": Variation(26.61, 0.068),
}
TABLE_11 = {
    "q_m1": Fit(77.59, 8.35, 10.76),
    "v_m1": Fit(85.50, 6.24, 7.30),
    "q_m2": Fit(88.00, 6.70, 7.62),
    "v_m2": Fit(85.50, 3.49, 4.08),
}

#: Inertia of the second link, P_2 [kg m^2], by stage.
TABLE_12 = {"link 2, high velocity": 0.135, "link 2, low velocity": 0.185, "both links": 0.136}
