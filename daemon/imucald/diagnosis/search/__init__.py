"""Search for causes on a table of blocks. A cause is named if it improves the prediction of data
outside its fit.

`trials` tests each hypothesis with its parameters freed. `search` selects the best hypothesis, step
by step, and tests each named cause again together with the others. `shift` looks for a sensor that
is rotated in the middle of a drive. `low_pass` distinguishes low-pass filters from delays. `state`
has the present results and the model with these results. Modules of this package call `fit` and
`equations`. `left_over` and the modules of `diagnosis` call this package.
"""
