"""A body whose mass, centre or inertia are not what the robot's description says."""

from types import SimpleNamespace

from torch import Tensor

from hybrid_id.components.base import Attached, Effect
from hybrid_id.components.site import free
from hybrid_id.parameters import Parameter

_Row = tuple[float | Tensor, float | Tensor, float | Tensor]


def _shift(axis: str) -> Parameter:
    return Parameter(
        0.0, lower=-10.0, upper=10.0, unit="m", doc=f"shift of the centre along {axis}", estimate=False
    )


def _stretch(axis: str) -> Parameter:
    return Parameter(1.0, lower=1e-2, upper=1e2, unit="1", doc=f"stretch along {axis}", estimate=False)


def _shear(axes: str) -> Parameter:
    return Parameter(0.0, lower=-1e2, upper=1e2, unit="1", doc=f"shear of {axes}", estimate=False)


class BodyInertia(Attached):
    """The ten inertial parameters of a body as deviations from the description, physical at every value.

    ``m = c_m m_0``, ``c = c_0 + (x_c, y_c, z_c)``, ``S = c_m L S_0 L^T``, ``I = tr(S) 1 - S``,
    ``L = [[s_x, s_xy, s_xz], [0, s_y, s_yz], [0, 0, s_z]]``, in the body's axes.

    | symbol | unit | meaning |
    | --- | --- | --- |
    | m_0, c_0 | kg, m | mass and centre in the description |
    | S, I | kg m^2 | second moments of the mass, and the inertia, about the centre; S_0 is the description's |
    | c_m | 1 | mass over the description's: the inertia grows with it as that of a denser body |
    | x_c, y_c, z_c | m | how far the centre lies from the description's (held by default) |
    | s_x, s_y, s_z, s_xy, s_xz, s_yz | 1 | how the body is stretched and sheared about its centre (held) |

    With c_m > 0 and s_x, s_y, s_z > 0 the pseudo-inertia is positive definite wherever the description's is. The joint
    at whose load it is listed must carry the body; a fit of one joint by itself estimates it at that joint alone.

    Source: C. Rucker, P. Wensing, Smooth Parameterization of Rigid-Body Inertia, IEEE RA-L 7, 2022 (log-Cholesky).
    Differs from it by a factor about the description's centre and not the body's origin, and by bounds above 0 in
    place of exponentials, so that every value has a unit and a meaning.
    """

    effect = Effect(
        "link_mass",
        "mass of a link, a tool or what it carries that the description does not have; usually up to half of it",
        "W. Khalil, E. Dombre, Modeling, Identification and Control of Robots, Hermes Penton, 2002",
        {
            "constant_torque": "slow motion over the whole range: a weight changes with the angle, a bias does not",
        },
    )
    kind = "body_inertia"
    option = "body"
    names = "the name of a body of the robot"
    c_m = Parameter(1.0, lower=1e-3, upper=1e3, unit="1", doc="mass over the description's")
    x_c, y_c, z_c = _shift("x"), _shift("y"), _shift("z")
    s_x, s_y, s_z = _stretch("x"), _stretch("y"), _stretch("z")
    s_xy, s_xz, s_yz = _shear("x with y"), _shear("x with z"), _shear("y with z")

    def shift(self, p: SimpleNamespace) -> tuple[Tensor, Tensor, Tensor]:
        """Shift of the centre [m], ``(B,)`` each."""
        return p.x_c, p.y_c, p.z_c

    def stretch(self, p: SimpleNamespace) -> tuple[_Row, _Row, _Row]:
        """Rows of L [1], ``(B,)`` each."""
        return (p.s_x, p.s_xy, p.s_xz), (0.0, p.s_y, p.s_yz), (0.0, 0.0, p.s_z)

    @staticmethod
    def starts(site):
        ends = dict.fromkeys((*site.bodies[:1], *site.bodies[-1:]))
        return [{BodyInertia.option: body, "c_m": free(1.0, 0.02, 500.0)} for body in ends]
