"""Test the residuals of the equations after the search, without a known cause.

Each module tests one property of the residual: size (`adequacy`, `louder`), frequency (`adequacy`,
`orders`), dependence on other signals (`pairs`), or change from segment to segment (`courses`). The
results are `Structure`s, or `Question`s that `fit.chance` tests together. The modules call
`search`, `fit` and `equations`, and change no state of these packages.
"""
