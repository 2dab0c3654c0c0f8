"""Statistics of identified parameters: plain arrays in, frozen results out; numpy and scipy only.

Import from the modules: `fit`, `variation`, `cross_validation`, `selection`, `uncertainty`, `bootstrap`,
`profile`, `trust`, `identifiability`, `combinations`.
"""
