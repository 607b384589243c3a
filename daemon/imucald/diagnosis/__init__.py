"""Diagnosis of the simulation: what it gets wrong in measured drives, why, and the gain.

`diagnose` is the whole path from samples to verdict; `recording` reads the samples, `outcome` words
the verdict. What all share stands here too: `signals`, the catalogue (`causes`, `cause_keys`) and
the `result`. The rooms below: `equations` (physics), `fit` (statistics), `search` (names), `direct`
(evidence without a fit), `left_over` (tests without a cause).
"""
