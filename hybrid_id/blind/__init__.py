"""Cases whose unmodelled effect is known to nobody but their answer sheet.

`physics` is a reality of its own: laws, an integrator and a MuJoCo engine that share no code with the models of the
package, so that no model can reproduce a record to the letter. `effects` names what may be at work in it, in several
formulas each. `robots`, `signals` and `campaign` draw machines and experiments, `case` writes them as folders with
answers. Only `fitter` knows the identification of the package: it grades how hard a case is.
"""
