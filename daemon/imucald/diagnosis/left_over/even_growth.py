"""Test whether a cause named as linear growth over the drive really grows linearly.

A drifting zero and two clocks that run apart are ramps. A restart, a clock that is set, or a knock
makes a step; a ramp explains three quarters of a step. A ramp describes the drive only if it
predicts unseen data better than every step.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.fit.score import Hypothesis, Problem, held_out, paired
from imucald.diagnosis.left_over.stability import LEAST_SIDE, moment
from imucald.diagnosis.outcome import first_signal
from imucald.diagnosis.result import WANDERS, Structure
from imucald.diagnosis.search.standing import put_back
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import SINGLE, Trial, on_table


def uneven_growth(problem: Problem, state: State) -> list[Structure]:
    """Named ramps that a step explains as well (one question, 5 %, deviation from the scatter
    between segments)."""
    return [s for t in state.named for s in _as_steps(problem, state, t)]


def _as_steps(problem: Problem, state: State, trial: Trial) -> Iterator[Structure]:
    h, table = trial.hypothesis, problem.table
    if h.pattern is not None:
        ramp, null, keys = held_out(problem, on_table(h, table)), problem, h.keys
    elif h.name == "delay_rate" and "speed.delay_s" in table.keys:
        rate, delay = "speed.delay_rate", "speed.delay_s"
        ramp, keys = held_out(problem), (delay,)
        null = put_back(problem, state, (rate,))
        i = table.keys.index(delay)
        low, high = null.low.copy(), null.high.copy()
        low[i], high[i] = table.plausible[i]
        null = replace(null, low=low, high=high)
    else:
        return
    best: tuple[float, float, int] | None = None
    for k in range(LEAST_SIDE, table.blocks - LEAST_SIDE + 1):
        step = Hypothesis(h.name, keys, pattern=_step(table.blocks, k))
        behind, se = paired(held_out(null, step), ramp, table.number, table.number)
        if best is None or behind < best[0]:
            best = behind, se, k
    if best is None:
        return
    behind, se, k = best
    sure = float(student.ppf(1.0 - SINGLE, table.blocks - 1))
    if behind > sure * se:
        return
    text = (
        f"{keys[0].rpartition('.')[0] if len(keys) > 1 else keys[0]} may have changed once at "
        f"{moment(table, k)} instead of growing evenly: this explains unseen segments as well"
    )
    signal = first_signal(table, keys)
    size = float(sure * se / max(behind, 1e-9)) if behind > 0.0 else float(table.blocks)
    yield Structure(signal, WANDERS, size, text, h.keys[0])


def _step(blocks: int, k: int) -> Array:
    return (np.arange(blocks) >= k).astype(float)
