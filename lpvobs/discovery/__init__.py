"""The closed loop: residual = what is not known + effects + noise, and the model that has the effects.

One loop for every engine. `residual` lays out logs at `places`, `imbalances` draws up the balances, `fit` finds the joint model,
`ranking` and `evidence` weigh one effect at a time, `select` adds them, `held_out` judges, `refine` runs it all.
`docs/architecture.md` follows a residual through them.
"""
