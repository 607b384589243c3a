"""Least squares on a table of blocks: values, intervals, held-out losses, chance.

`blocks` sums residuals and columns into Gram matrices. `box` solves within bounds. `score` fits one
part of the data and tests the fit on another part. `intervals` computes the accuracy of values.
`chance` controls the common rate of false results of many tests. No module of this package decides
on a cause. The modules call `equations`. `search`, `direct`, `left_over` and the modules of
`diagnosis` itself may call this package.
"""
