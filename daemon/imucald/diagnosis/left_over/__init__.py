"""Test the residuals of the equations after the search, without a known cause.

Each module tests one property of the residual: size (`adequacy`, `louder`), frequency (`lines`,
`orders`), other signals (`pairs`, `patterns`), or change from segment to segment (`stability`,
`between_segments`, `even_growth`, `uneven_segments`). The answers are `Structure`s, or `Question`s
that `fit.chance` judges together. Modules here call `search`, `fit` and `equations`, and change
nothing there.
"""
