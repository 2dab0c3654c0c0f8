"""One independent physics, for all that must share no code and no number with the models and the diagnosis.

`physics` is a reality of its own: laws, machines, two time steppings and a MuJoCo engine, so that no model can
reproduce a record to the letter. The rest makes cases whose unmodelled effect nobody knows but their ground truth:
`effects` names what may be at work, in several formulas each; `robots` and `experiments` draw machines and what is
done to them; `grading` and `rivals` say how hard a case is and what else explains it; `draw` makes clean cases,
`messy` messy ones out of `mixtures`, `arms` those of two to seven joints; `make` writes folders, `seal` puts the
answers away, `judge` and `score` hold diagnoses against them. `desk_arm` moves the demo's arm. It imports records and
errors only.
"""
