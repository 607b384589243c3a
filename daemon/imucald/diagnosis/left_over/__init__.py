"""Questions about structure that no cause of the catalogue explains.

`table` has all questions, each with its statistic. `remains` has the residuals that the statistics
need. Each other module tests one property of the residual: size (`adequacy`, `louder`), frequency
(`adequacy`, `orders`), dependence on other signals (`pairs`), or change from segment to segment
(`courses`). The modules call `direct`, `search`, `fit` and `equations`, and change no state of
these packages.
"""
