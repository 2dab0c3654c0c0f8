"""Statistics of identified parameters: plain arrays in, frozen results out; numpy and scipy only.

Import from the modules: `fit`, `residuals`, `variation`, `cross_validation`, `uncertainty`, `profile`,
`reliability`, `identifiability`.
"""
