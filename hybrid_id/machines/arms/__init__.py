"""Arms of two to seven joints in MuJoCo, of which something is missing in their description.

`robot` draws trees of links with a drive at every joint, `effects` what acts at a joint beyond them, `motion` moves
arms in MuJoCo, `refit` fits each joint by itself for what an effect is worth, `case` puts a case and its ground truth
together.
"""
