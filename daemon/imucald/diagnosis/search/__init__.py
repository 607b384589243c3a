"""From a table of blocks to named causes: those that improve the prediction of data outside their
fit.

`trials` tests each hypothesis with its parameters freed. `search` lets the hypotheses compete.
`standing` tests each again with the others. `shift` looks for a sensor turned in mid-drive.
`low_pass` separates low-passes from delays. `state` holds the results so far and the model moved by
them. Modules here call `fit` and `equations`. `left_over` and the room above call them.
"""
