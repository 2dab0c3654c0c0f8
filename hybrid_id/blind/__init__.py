"""Cases whose unmodelled effect is known to nobody but their answer sheet.

`physics` is a reality of its own: laws, an integrator and a MuJoCo engine that share no code with the models of the
package, so that no model can reproduce a record to the letter. `effects` names what may be at work in it, in several
formulas each. `robots`, `signals` and `campaign` draw machines and experiments; `refit` and `levels` say how hard a
case is, with the same physics; `make` writes cases as folders with answers. Of the package it imports records and
errors only.
"""
