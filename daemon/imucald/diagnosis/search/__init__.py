"""From a table of blocks to names: which causes pay on data that their fit did not see.

`trials` holds what freeing each hypothesis comes to; `search` lets them compete; `standing` asks
each again with the others; `shift` looks for a sensor turned in mid-drive. `state` carries what
is known so far, and where that moves the model to. Modules here call `fit` and `equations`.
`left_over` and the room above call them.
"""
