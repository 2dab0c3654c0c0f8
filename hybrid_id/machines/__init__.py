"""One independent physics, for all that must share no code and no number with the models and the diagnosis.

`physics` is a reality of its own: laws, the stepping of drives through set-valued dry friction, and trees of links in
MuJoCo, so that no model can reproduce a record to the letter. `desk_arm` moves the demo's arm. The rest makes cases
whose unmodelled effect nobody knows but their ground truth: `effects` names what may be at work, in several formulas
each; `robots`, `arm` and `experiments` draw machines and what is done to them; `trials` records machines and re-fits
their simulators, `joint` those of one joint of an arm; `rivals` finds what else explains a case; `draw` and `draw_arm`
put a `case` together; `make` writes folders, `seal` puts the answers away, `score` holds diagnoses against
them. It imports records and errors only.
"""
