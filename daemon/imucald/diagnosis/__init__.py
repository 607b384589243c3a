"""Diagnosis of the simulation: its errors against measured drives, their causes, and the gain of a
corrected model file.

`diagnose` is the whole path from samples to verdict. `recording` reads the samples; `outcome` puts
the verdict into words. This package also has the modules that all its parts share: `signals`, the
catalogue (`causes`, `cause_keys`) and `result`. The parts are `equations` (physics), `fit`
(statistics), `search` (naming of causes), `direct` (evidence without a fit), `left_over` (tests for
structure without a known cause).
"""
