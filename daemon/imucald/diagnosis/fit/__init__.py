"""Least squares on a table of blocks: values, intervals, held-out losses, chance.

`blocks` sums residuals and columns into Gram matrices. `box` solves within bounds. `score` fits one
part of the data and tests on another. `intervals` and `sandwich` give the accuracy of values.
`chance` holds many questions to one rate of false answers. No module here decides on a cause.
Modules here call `equations`. `search`, `direct`, `left_over` and the room above may call them.
"""
