"""Seeds: which drives each part is made of, and which ones the estimator was tuned on.

A figure counts only on drives that nothing was chosen by. records/mount-accuracy.md says what was
looked at when; seeds that become tuning seeds are added here.
"""

from __future__ import annotations

from collections.abc import Iterable

FIRST_SEED = 400_000
"""Where the benchmark's own seeds begin: nothing was tuned on them."""

TUNING_SEEDS = (
    range(0, 401),
    range(2001, 2017),
    range(3000, 3017),
    range(7200, 7320),
    range(8000, 8480),
    range(8500, 8620),
    range(9000, 9794),
    range(12000, 12060),
    range(40000, 40620),
    range(41000, 41100),
    range(42000, 42120),
    range(43000, 43060),
    range(45000, 45040),
    range(46000, 46040),
    range(53000, 53150),
    range(70000, 70240),
    range(140000, 140150),
    range(141000, 141200),
    range(142000, 142160),
    range(143000, 143080),
    range(920000, 920003),
    range(955015, 955016),
    range(970000, 970020),
    range(978000, 978006),
    range(978400, 978420),
    range(980000, 980001),
    range(991000, 991040),
    range(992100, 992103),
    range(994000, 994010),
    range(1003000, 1003022),
    range(1200000, 1200004),
    range(1200010, 1200012),
    range(1210000, 1210006),
    range(1271000, 1271003),
    range(1300000, 1300006),
    range(1320000, 1320001),
    range(1330000, 1330017),
    range(1410000, 1410061),
    range(1450038, 1450039),
    range(1450113, 1450114),
    range(1500000, 1500001),
    range(1510011, 1510012),
    range(1530001, 1530002),
    range(1560000, 1560042),
    range(1580000, 1580010),
    range(1740010, 1740016),
    range(1740040, 1740045),
    range(1740060, 1740070),
    range(1820000, 1820012),
    range(1830000, 1830040),
    range(1840000, 1840044),
    range(1910011, 1910012),
    range(1910017, 1910018),
    range(1912000, 1912004),
    range(1921005, 1921006),
    range(1921064, 1921065),
    range(1930000, 1932220),
)

SHIFTS_AT, SHIFTS_APART, BOUND_AT, LONG_AT, QUIET_AT = 300, 100, 1200, 2000, 3000
"""Where the seeds of each part begin, after the first; seeds between two kinds of shift."""


def tuned_on(seeds: Iterable[int]) -> list[int]:
    """Those of the seeds that the estimator was tuned on."""
    return [seed for seed in seeds if any(seed in tuned for tuned in TUNING_SEEDS)]
