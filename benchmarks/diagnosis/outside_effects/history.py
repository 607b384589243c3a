"""When each outside effect was written, and which judge asked it first.

What is seen of an effect that was asked before the tests stood, or was looked at while they were
changed, says little of an effect that nobody thought of. So each has its date here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Batch:
    """Effects that were written at one time. first_draw: of the judge that ran them first; None:
    they were run while the tests were made, before any judge."""

    effects: tuple[str, ...]
    written: str
    """UTC."""
    first_draw: int | None
    known: str
    """What the writer knew of the tests, and what was left out."""


BATCHES = (
    Batch(
        ("shaking", "swing", "gusts", "hysteresis", "dead_zone", "glitches"),
        "2026-11-22 07:42", None,
        "The tests of `diagnosis.left_over.adequacy` and the generator's own outside effects were "
        "known. Seen many times since (hysteresis and dead_zone also before `patterns` and "
        "`held_values` were written).",
    ),
    Batch(
        ("fading", "restarts", "held_speed"), "2026-11-22 16:30", 13,
        "The method stood; they were not run before its judge.",
    ),
    Batch(
        ("wheel_slip", "loose_contact", "heated_gain"), "2026-11-22 19:08", 14,
        "Before anything of the tests was changed that day. Since 19:20 all effects are put in on "
        "the sensor's own levels: before, a gain made every value but 0 a level of its own, which "
        "gave it away.",
    ),
    Batch(
        ("gyro_highpass", "supply_dips", "speedometer"), "2026-11-22 22:26", 15,
        "Each from a published source, before anything of the tests was looked at or changed that "
        "evening.",
    ),
    Batch(
        ("clock_step", "tyre_growth"), "2026-11-23 01:45", 16,
        "Before anything of the tests was changed that day. A third, a gyroscope that feels "
        "acceleration, was taken out before its outcome was looked at: the catalogue has it.",
    ),
    Batch(
        ("uneven_gain", "outer_wheel", "engine_beat", "tone_wheel"), "2026-11-23 05:10", 17,
        "Each from a published source, before anything of the tests was looked at or changed in "
        "that session; only what an ideal filter sees of them was computed.",
    ),
    Batch(
        ("auto_zero", "learned_zero", "whole_kmh", "slow_wheels"), "2026-11-23 06:50", 23,
        "Each from a published source, by one who read neither the tests nor their page; only what "
        "an ideal filter sees of them was computed. A soft holder's resonance at 5 Hz and a cab "
        "that pitches at 1.2 Hz were left out: the ideal filter saw each in no long log but one, "
        "and there at twice the size. A speed held for 1 s and a jitter of stamps were left out "
        "for these four.",
    ),
    Batch(
        ("missing_bit", "brake_lamps", "range_reset", "second_gyro", "multipath", "whole_seconds"),
        "2026-11-23 09:56", 29,
        "Each from a published source, by one who read neither the tests nor their page; only what "
        "an ideal filter sees of them was computed, on draws 0 and 1. Tyre slip that follows the "
        "acceleration was left out: the ideal filter saw it in css_canmod_164 and, at three times "
        "the size, in one half of vehsense_2018_08_04, in no other. Registers read while they "
        "change were left out: it takes what the sensor held a few ms before, which a log of 10 Hz "
        "does not have. Stalls of a logger were left out: samples 1 ms apart, which the ideal "
        "filter sees 41 times over in css_canmod_164. A speed over the last 8 m was left out: its "
        "mean delay is one, which the catalogue has. A gyroscope's zero that moves with a "
        "resonance of its board was seen, and left out for these six.",
    ),
    Batch(
        ("shifted_words", "lost_differences", "compass_pull", "handlebar", "curve_logging",
         "predicted"),
        "2026-11-23 13:22", 35,
        "Each from a published source, by one who read neither the tests nor their page; only the "
        "size of the change and what an ideal filter sees of it were computed, the latter on draw "
        "0, and of the sizes one was changed before that, as it changed a log by up to 0.93 m/s2 "
        "rms: a share of 0.005 lost differences, half of another source's limit, to 0.001. "
        "No steering and no yaw rate, since no log has them. A repeated block, a ground speed "
        "radar that pitches and a speed of two sources, one late, were left out: too near to stuck "
        "values, to what was left out before, and to a delay.",
    ),
    Batch(
        ("wheel_wire", "idle_pulses", "left_charge", "loose_screw", "board_resonance",
         "swapped_blocks"),
        "2026-11-23 17:47", 41,
        "Each from a published source, by one who read neither the tests nor their page nor an "
        "outcome, but this package and the ideal filter; only the size of the change and what an "
        "ideal filter sees of it were computed, the latter on draw 0, and no size was changed "
        "after. A load that comes and "
        "goes at stops and a unit that levels itself at each stop were left out: a row of mount "
        "shifts, which the catalogue has. A slack tank, a pendulum and a vehicle that leans are "
        "body roll to first order, a filter in whole numbers is a bias and a low-pass, stamps of a "
        "buffer's end are a delay, and a noise of radio or of a motor's current was too near to "
        "what is there.",
    ),
    Batch(
        ("tyre_difference", "steered_axle", "after_jolts", "peaks_kept", "sent_on_change",
         "full_queue"),
        "2026-11-23 19:07", 47,
        "Each from a published source, cited from memory, by one who read neither the tests nor "
        "their page nor an outcome, but this package and the ideal filter; only the size of the "
        "change was computed before they were kept, and no size was changed after. A low byte "
        "taken as signed was left out: a missing bit in another place. Stamps of a FIFO spread by "
        "a nominal rate were left out: too near to stamps of whole seconds; a phone that is "
        "picked up: a row of mount shifts; a gyroscope made of a compass and an accelerometer, and "
        "rates with an attitude filter's correction in them: too near to body roll and to a "
        "gyroscope that feels acceleration; a spring broken on one side: half of it is body roll.",
    ),
    Batch(
        ("auto_sleep", "lost_sign", "bit_errors", "filled_gaps", "virtual_gyro",
         "rounded_positions"),
        "2026-11-24 00:42", 53,
        "Each from a published source, by one who read neither the tests nor their page nor an "
        "outcome, but this package, the ideal filter and a few titles of changes to the diagnosis. "
        "Looked up: the wake and sleep of auto_sleep, the issues on lost_sign, the receiver of "
        "bit_errors, the coordinates of rounded_positions, the range of virtual_gyro, the filling "
        "of filled_gaps; from memory: its timeouts, the books, and what a page or a section is "
        "named. The 0.25 g and the 5 s of auto_sleep and the 20 to 60 s of filled_gaps are the "
        "writer's choice within what the sources allow. Sizes were fixed before anything was "
        "computed; then only the size of the change and what an ideal filter sees of it, in the "
        "first halves beside the plain car, one draw from a generator of its own. Left out: a "
        "phone that is typed on (no source for its size), a sensor on a gimbal (too near to a "
        "handlebar), two units with one identifier (cross-axis and gain on average), a "
        "yaw rate made of satellite courses (noise, most of it at a crawl), a bus that kneels "
        "(only at stops), stamps counted over lost blocks (a clock drift in steps), a phone lying "
        "loose that slides (too rare), and a speed that a filter makes of the accelerometer too.",
    ),
    Batch(
        ("unit_length", "outliers_filled", "engine_gear", "by_distance", "flat_degrees",
         "camera_scale"),
        "2026-11-24 15:06", 59,
        "Each from a published source, by one who read neither the tests nor their page nor an "
        "outcome, but this package, the ideal filter and a few titles of changes to the diagnosis. "
        "Looked up: the issues on unit_length, by_distance and flat_degrees, the rule of "
        "outliers_filled, the formula and the times of engine_gear; from memory: the paper and the "
        "numbers of camera_scale. The 200 m of camera_scale, the turns at which engine_gear shifts "
        "and that flat_degrees is right over the log are the writers' choice. Each size "
        "was fixed before anything of that effect was computed; then only the size of the change "
        "and what an ideal filter sees of it, in the first halves beside the plain car, one draw "
        "from a generator of its own. It sees each in all logs with a gyroscope, at its own size "
        "but for one loose phone with flat_degrees and one with unit_length, at 1.5 times; where "
        "there is no gyroscope, engine_gear and by_distance alone. A sixth, roads that lean into "
        "their bends (banked_bends, dated 14:51 with the other five), was taken out before any "
        "run: a road is no error of a vehicle or a sensor, and of a cross fall the judge counts "
        "nothing as right elsewhere. A second writer, as blind, wrote flat_degrees in its place. "
        "by_distance is the nearest to what is there: values stand in sent_on_change too, but "
        "there until they change. Left out: rates that run over a word of 16 bits at 32.768 "
        "deg/s (hardly a log turns so fast: the filter saw 0.9 deviations of it in one, nothing "
        "in the others; camera_scale took its place), a limit on how fast the speed of an ABS "
        "changes (a patent without a number), increments divided by the gaps of their arrival "
        "(no number either), a speed set to 0 on a smooth road (a stuck signal), fractions "
        "without their leading zeros and numbers without their exponent (too near to a lost "
        "sign), a crab-like walk and a slide (too near to a loose screw), and digits misread "
        "from a picture (too near to bit errors).",
    ),
    Batch(
        ("pitot", "fixed_height", "vibration_alert", "other_answers", "slope_overload",
         "heading_jumps"),
        "2026-11-24 16:35", 71,
        "Each from a published source, by one who read neither the tests nor their page nor an "
        "outcome, but this package, the ideal filter and, by a search that went too far, one line "
        "of the benchmarks' history on unmodified drives and a late speed. Looked up: the issues "
        "and pull requests on fixed_height, other_answers and heading_jumps; from memory: papers, "
        "standards and data sheets. The 5 s of a gust, the place of the flow sensor, how often "
        "somebody calls and the ten messages a second of slope_overload are the writer's choice. "
        "Sizes were fixed before anything was computed, and none was changed; then only the size "
        "of the change and what an ideal filter sees of it, in the first halves beside the plain "
        "car, one draw from a generator of its own. Of five logs with a gyroscope it sees pitot, "
        "other_answers and slope_overload in all at their own size, fixed_height in all but "
        "kingston_2008 (0.06 m/s rms there), vibration_alert and heading_jumps in the three that "
        "are no loose phones; heading_jumps changes nothing in a log that never comes through "
        "north, as in that draw in the two loose phones. Where there is no gyroscope, "
        "other_answers alone. Replaced: an accelerometer cleaned by wavelets with a soft threshold "
        "(seen in two of five, at twice the size too), by heading_jumps, whose size nobody "
        "chooses. Left out: a trailer's accelerometer beside the truck's gyroscope (a delay by "
        "distance), bytes of two cycles in one word (as registers read while they change), a speed "
        "averaged over each piece of road (too near to by_distance), a comfort meter's weighting "
        "(too near to the high-pass of a gyroscope), a zero that walks at random (too near to a "
        "drift), popcorn noise (too near to second_gyro). No judge of draw 65 was run. Who changed "
        "the tests on 2026-11-27 had read this page, and the functions of other_answers and "
        "slope_overload, before the change was complete; none was run.",
    ),
    Batch(
        ("north_frame", "fourier_blocks", "steering_play", "supply_ripple", "smoothed_fixes",
         "other_gearbox"),
        "2026-11-27 23:31", 71,
        "Each from a published source, by one who read neither the tests nor their page nor an "
        "outcome, but this package, the ideal filter, the catalogue and, more than was needed, how "
        "the judge cuts the logs and writes a line of its outcome (measured_logs, the first half "
        "of outcome), with what is true of three logs as they are. Looked up: all issues and pull "
        "requests (of some no more than the title and the first words), the ten coefficients of "
        "fourier_blocks, the play at which a test station rejects, the data sheet's numbers of "
        "supply_ripple, the filter and its Q of smoothed_fixes, the two gearboxes; from memory: "
        "Bowditch, the accuracy of 5 m, the steering's ratio, the ripple of 1 %. The 10 s of a "
        "block, the 0.3 m/s2 that turn the play over, the 0.5 Hz and 80 s of the ripple, that it "
        "meets the upright axis, the stamps set back in smoothed_fixes and the turns at which "
        "other_gearbox shifts are the writer's choice. Sizes were fixed before anything was "
        "computed, none was changed and none of the six was replaced; two words of docstrings were "
        "set right before the first run. Then only the size of the change, one draw from a "
        "generator of its own in the first halves beside the plain car, and what an ideal filter "
        "sees of it, on draw 0. Of five logs with a gyroscope it sees fourier_blocks, "
        "supply_ripple and other_gearbox in all at their own size, steering_play in all, in one "
        "loose phone at twice the size, smoothed_fixes in the three that are no loose phones and "
        "at twice the size in one that is, north_frame in those three alone. Where there is no "
        "gyroscope, other_gearbox at 1.5 times; fourier_blocks not. Nearest to what is there: "
        "steering_play to virtual_gyro (the same source of the rate, another error), other_gearbox "
        "to engine_gear (wrong in a gear, not in a shift), smoothed_fixes to rounded_positions. "
        "Left out: a rate made of the course of a map's road (in bends its error is as large as "
        "the rate), acceleration as whole numbers where a comma was not read (near to whole_kmh "
        "and dead_zone), increments of velocity along the axes at the beginning of each second "
        "(near to a handlebar), speed in the steps of 8 % of an amateur radio format (near to "
        "whole_kmh, and nobody sends so once a second), a gate that throws out sudden speeds (the "
        "limits that are published are never reached), a gyroscope that sticks as it changes its "
        "range (1 to 2 ms, above 100 deg/s), steered rear wheels (a lever that grows with the "
        "square of the speed: tyre slip), a driveline that rings after a step of torque (no number "
        "for the speed), ultrasound (no source in a car), trailers (as before), and a mast that "
        "the wind of driving bends (near to left_charge).",
    ),
    Batch(
        ("warm_gas", "tin_whisker", "late_sign", "momentum", "digits_as_hex", "few_components"),
        "2026-11-28 00:07", 77,
        "Each from a published source, by one who read neither the tests nor their page nor an "
        "outcome, but this package, the ideal filter, the catalogue, real_effects and the names, "
        "not the text, of measured_logs, and knew that a second writer wrote six others at the "
        "same time; two of the accelerometer, one of the gyroscope, one of the speed and two of "
        "what packs and decodes were asked for. Looked up: that a thermal accelerometer's gain "
        "goes with a power of the temperature and where ADAC begins its test, the short between "
        "two outputs (its 250 ohm are from memory), rate and sign as two signals and the pull "
        "request on such a sign, the noise of 1 m/s and both pull requests of momentum, the "
        "digits in the decoder and the issue (which can be read so; the protocol that is decoded "
        "there has a number), the first paper of few_components; from memory: the power of 2.67, "
        "the formula of the gains, the 32 kilohm, what scikit-learn does. The ten minutes and the "
        "calibration in a warm car, that it is the two most level axes, the spells of the whisker "
        "(those of `spells`), the raster of 1 s, the change of 0.5 m/s2 in a second, that the way "
        "of digits_as_hex is right over the log, and the minute of few_components are the "
        "writer's choice. Sizes were fixed before anything was computed, none was changed and "
        "none of the six was replaced; half a sentence of a docstring and the form of "
        "few_components, which does the same, were set right before the first run. Then only the "
        "size of the change, one draw from a generator of its own in the first halves, and what "
        "an ideal filter sees of it, on draw 0. Of five logs with a gyroscope it sees "
        "tin_whisker, late_sign, digits_as_hex and few_components in all at their own size, "
        "warm_gas and momentum in the three that are no loose phones, also at their own size, and "
        "in the two others not at three times it. Where there is no gyroscope, digits_as_hex "
        "alone, at its own size. Nearest to what is there: warm_gas to heated_gain (another "
        "sensor, once and slowly), late_sign to lost_sign (each change of side, not a band of "
        "values), digits_as_hex to whole_kmh (its whole knots are in it), momentum to predicted "
        "(all along, with no gap), few_components to fourier_blocks (over the axes, not over "
        "time). Left out: a judder of the brakes and a wheel out of balance (at the turns of a "
        "wheel, where earlier writers saw the ideal filter find little), self-tests that go on "
        "while driving (near to glitches and loose_contact), a converter's step at half scale "
        "(near to missing_bit), the filter of Linux' input drivers (near to sent_on_change), "
        "zeros set anew between two stops (a tilt of each piece), blocks in reverse order (near "
        "to swapped_blocks, and no issue was found), wheel pulses timed by a counter that runs "
        "over (garbage below a speed), one pulse a turn (near to by_distance and slow_wheels), a "
        "gyroscope that is switched off at stops and warms up (no number), an open-loop fibre "
        "gyroscope (a cubic that is small in a car), a learned scale of wheel pulses (no number).",
    ),
    Batch(
        ("rim_accelerometer", "coarse_ticks", "magnetic_turns", "slow_passes", "held_at_one_end",
         "running_median"),
        "2026-11-28 00:29", 77,
        "Each from a published source, by one who read neither the tests nor their page nor an "
        "outcome, but this package, the ideal filter, the catalogue, the real effects and the "
        "cases; of the measured logs their names, as the ideal filter prints them. Looked up: all "
        "issues and pull requests (of most the title and the first words), the patent's first "
        "words, the ticks, the band of mounts' resonances, the deviations of a compass; from "
        "memory: the zero error of 1 g (a data sheet of which only other pages were found), what a "
        "gain of 0.5 means in seconds, a phone's weight and size. Radii of the rim and the tyre, "
        "five messages a second, the weight of 0.3, 100 passes a second, how often the modem is "
        "asked, 40 mm beside the joint and 15 deg of 10 to 21 are the writer's choice. Sizes were "
        "fixed before anything was computed, none was changed and none of the six was replaced. "
        "Then only the size of the change and what an ideal filter sees of it, on draw 0. Of five "
        "logs with a gyroscope it sees rim_accelerometer and coarse_ticks in all at their own "
        "size, slow_passes and held_at_one_end in all, in one loose phone each at 1.5 times, "
        "running_median in two and in the other three at 1.5 times, magnetic_turns in the three "
        "that are no loose phones and in no other. Where there is no gyroscope, coarse_ticks at "
        "its own size, rim_accelerometer and running_median at three times; slow_passes not. "
        "Nearest to what is there: magnetic_turns to north_frame and compass_pull (the same iron, "
        "another signal), rim_accelerometer to slow_wheels (below 2.2 m/s half of the time), "
        "slow_passes to full_queue (spells, another signal and no delay of stamps), coarse_ticks "
        "to increments divided by the gaps of their arrival, which were left out twice as nobody "
        "gave a number: here the clock does. Left out: a heading by compass at a crawl and by "
        "satellites above (one compass is enough), accelerations turned from north by a late "
        "course (near to north_frame and handlebar), an attitude filter that refuses strong forces "
        "only (near to auto_zero), a gyroscope that takes its zero where it boots, in motion (near "
        "to restarts and learned_zero), a yaw rate levelled by the accelerometer's tilt (half of "
        "it is a gain), a dashboard's hysteresis (a delay to first order), a radar that feels "
        "heave (one axis sees another), axes read one after another (two delays), the pendulum of "
        "a hub odometer (nobody gives its damping), a contact that bounces at a crawl and a speed "
        "of one magnet (near to slow_wheels and by_distance), a gain that falls while satellites "
        "are gone (near to second_gyro), three speeds of which the middle one counts (too near to "
        "held_speed), a lamp that blinks on the accelerometer's supply (near to supply_dips and "
        "brake_lamps), a unit that hangs with play and a leaning that air springs level out (body "
        "roll, and near to auto_zero), a phone that rocks on its camera (near to hysteresis), a "
        "phone in a driver's pocket (a driver), and brakes that judder (no number for the force).",
    ),
)  # fmt: skip
"""In the order of writing."""
FIRST_DRAW: Mapping[str, int | None] = {x: b.first_draw for b in BATCHES for x in b.effects}
"""Effect to the draw of the judge that ran it first."""
NOT_RUN = tuple(x for x, draw in FIRST_DRAW.items() if draw == BATCHES[-1].first_draw)
"""Not run before the judge of their first draw, which the bar of new effects counts."""
