"""Faults that are seen in samples and stamps rather than in physics.

Saturation, drop-outs, stuck signals and clock drift have one module each. They are looked for
first: what they spoil is kept from the rest of the diagnosis, stamps that run off are set right.
"""

from imucald.diagnosis.faults.examine import corrected, extend, find_faults, spoilt
from imucald.diagnosis.faults.fault import Fault

__all__ = ["Fault", "corrected", "extend", "find_faults", "spoilt"]
