"""Diagnosis of the simulation: the differences between simulated and measured drives, their causes,
and the gain of a corrected model file.

`diagnose` does all steps from samples to verdict. `recording` reads the samples. `outcome`
describes the verdict in words. The modules `signals`, `causes`, `cause_keys` and `result` are used
by all parts of this package; `causes` and `cause_keys` are the catalogue. The parts are `equations`
(physics), `fit` (statistics), `search` (naming of causes), `direct` (evidence without a fit),
`left_over` (tests for structure without a known cause).
"""
