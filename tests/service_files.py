"""States as the tests of the service save them."""

from __future__ import annotations

from imucald.service.saved_state import SavedState, StateKey

KEY = StateKey("car-17", "a" * 64)
IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
SMALL = (1e-4, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1e-4)


def state(number: float = 0.0, **changes) -> SavedState:
    """A state that can be told by its `driven_s`."""
    fields = {"rotation": IDENTITY, "covariance": SMALL, "state": "fine", "driven_s": number}
    return SavedState(**{**fields, **changes})
