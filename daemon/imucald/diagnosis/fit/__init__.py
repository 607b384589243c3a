"""Least squares on a table of blocks: values, intervals, held-out losses, chance.

`blocks` sums residuals and columns into Gram matrices. `box` solves within bounds. `score` fits one
part of the data and tests on another. `intervals` gives the accuracy of values.
`chance` gives many questions one common rate of false answers. No module here decides on a cause.
Modules here call `equations`. `search`, `direct`, `left_over` and the modules of `diagnosis` itself
may call them.
"""
