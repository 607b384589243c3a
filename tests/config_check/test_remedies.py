"""What `check` advises where frames are rejected."""

from __future__ import annotations

from collections import Counter

import pytest

from imucald.config_check.decoding import _REMEDIES, _remedy
from imucald.inputs.rate_guard import DUPLICATE, TOO_FAST


@pytest.mark.parametrize(("reasons", "key"), [
    ({"counter_jump": 5, "untrusted": 15}, "counter"),
    ({"checksum": 5, "untrusted": 15}, "checksum"),
    ({"doubled": 900, "counter_repeated": 3}, "doubled"),
    ({"too_early": 2}, "too_early"),
    ({DUPLICATE: 2}, "duplicate_sender"), ({TOO_FAST: 2}, "too_fast"),
])  # fmt: skip
def test_the_remedy_is_that_of_the_most_frequent_cause_and_not_of_what_follows_it(reasons, key):
    assert _remedy(Counter(reasons)) == _REMEDIES[key]


def test_without_a_known_cause_there_is_none():
    assert _remedy(Counter({"untrusted": 3})) == ""
