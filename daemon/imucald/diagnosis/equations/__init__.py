"""Predict the signals of a drive from each other by physics alone.

`reading` reads a drive with a model file. `motion` evaluates the equations; their parts stand in
`kinematics` and `single_track`. `forward` gives the residuals and their columns block by block.
Nothing here uses statistics. Modules here use `signals`, `causes` and `cause_keys`. All other
modules of `diagnosis` may call them.
"""
