"""Effects that the catalogue does not have, put into measured samples.

Which were written when, what was left out then, and which judge ran them first: `history`. The
twelve of the last two batches are not run before the judge of draw 77.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from benchmarks.diagnosis.outside_effects import (
    accelerometer,
    carriers,
    electronics,
    gyroscope,
    signal_sources,
    speed,
    transport,
)
from benchmarks.diagnosis.outside_effects.history import NOT_RUN
from benchmarks.diagnosis.real_effects import Put

__all__ = ["NOT_RUN", "OUTSIDE"]

OUTSIDE: Mapping[str, tuple[Put, float, str]] = {
    "shaking": (accelerometer.shaking, 0.3, "accel"),
    "swing": (accelerometer.swing, 0.4, "accel"),
    "gusts": (accelerometer.gusts, 0.4, "accel"),
    "hysteresis": (accelerometer.hysteresis, 0.2, "accel"),
    "dead_zone": (gyroscope.dead_zone, 0.035, "gyro"),
    "glitches": (gyroscope.glitches, 0.2, "gyro"),
    "fading": (gyroscope.fading, 0.25, "gyro"),
    "restarts": (accelerometer.restarts, 0.3, "accel"),
    "held_speed": (speed.held_speed, 1.0, "speed"),
    "wheel_slip": (speed.wheel_slip, 0.15, "speed"),
    "loose_contact": (accelerometer.loose_contact, 0.3, "accel"),
    "heated_gain": (gyroscope.heated_gain, 0.15, "gyro"),
    "gyro_highpass": (gyroscope.gyro_highpass, 0.016, "gyro"),
    "supply_dips": (accelerometer.supply_dips, 0.005, "accel"),
    "speedometer": (speed.speedometer, 4.0 / 3.6, "speed"),
    "clock_step": (speed.clock_step, 0.15, "speed"),
    "tyre_growth": (speed.tyre_growth, 0.015, "speed"),
    "uneven_gain": (gyroscope.uneven_gain, 0.05, "gyro"),
    "outer_wheel": (speed.outer_wheel, 0.75, "gyro"),
    "engine_beat": (accelerometer.engine_beat, 1.0, "accel"),
    "tone_wheel": (speed.tone_wheel, 0.02, "speed"),
    "auto_zero": (accelerometer.auto_zero, 0.1, "accel"),
    "learned_zero": (gyroscope.learned_zero, float(np.deg2rad(3.0)), "gyro"),
    "whole_kmh": (speed.whole_kmh, 1.0 / 3.6, "speed"),
    "slow_wheels": (speed.slow_wheels, 0.9, "speed"),
    "missing_bit": (accelerometer.missing_bit, 0.319, "accel"),
    "brake_lamps": (accelerometer.brake_lamps, 0.3, "accel"),
    "range_reset": (gyroscope.range_reset, 20.0, "gyro"),
    "second_gyro": (gyroscope.second_gyro, float(np.deg2rad(0.3)), "gyro"),
    "multipath": (speed.multipath, 0.4, "speed"),
    "whole_seconds": (speed.whole_seconds, 1.0, "speed"),
    "shifted_words": (transport.shifted_words, 0.85, "gyro"),
    "lost_differences": (transport.lost_differences, 0.001, "accel"),
    "compass_pull": (gyroscope.compass_pull, float(np.deg2rad(10.0)), "gyro"),
    "handlebar": (carriers.handlebar, 1.4, "gyro"),
    "curve_logging": (transport.curve_logging, 1.0, "speed"),
    "predicted": (speed.predicted, 8.0, "speed"),
    "wheel_wire": (electronics.wheel_wire, 0.25, "gyro"),
    "idle_pulses": (electronics.idle_pulses, 1.0, "speed"),
    "left_charge": (electronics.left_charge, 0.006, "accel"),
    "loose_screw": (carriers.loose_screw, float(np.deg2rad(2.0)), "gyro"),
    "board_resonance": (carriers.board_resonance, float(np.deg2rad(0.3)), "gyro"),
    "swapped_blocks": (transport.swapped_blocks, 0.05, "accel"),
    "tyre_difference": (signal_sources.tyre_difference, 0.003, "gyro"),
    "steered_axle": (signal_sources.steered_axle, 5.9, "gyro"),
    "after_jolts": (signal_sources.after_jolts, 2.5, "accel"),
    "peaks_kept": (signal_sources.peaks_kept, 0.5, "accel"),
    "sent_on_change": (signal_sources.sent_on_change, float(np.deg2rad(2.0)), "gyro"),
    "full_queue": (signal_sources.full_queue, 1.5, "speed"),
    "auto_sleep": (accelerometer.auto_sleep, 1.0 / 1.56, "accel"),
    "lost_sign": (transport.lost_sign, 1.0, "accel"),
    "bit_errors": (transport.bit_errors, 0.01, "accel"),
    "filled_gaps": (transport.filled_gaps, 4.0, "accel"),
    "virtual_gyro": (signal_sources.virtual_gyro, 82.5 / 3.6, "gyro"),
    "rounded_positions": (signal_sources.rounded_positions, 1.11, "speed"),
    "unit_length": (accelerometer.unit_length, 1.0, "accel"),
    "outliers_filled": (transport.outliers_filled, 3.0, "accel"),
    "engine_gear": (speed.engine_gear, 1.0, "speed"),
    "by_distance": (signal_sources.by_distance, 30.0, "speed"),
    "flat_degrees": (signal_sources.flat_degrees, float(np.sqrt(2.0)) - 1.0, "gyro"),
    "camera_scale": (signal_sources.camera_scale, 0.055, "speed"),
    "pitot": (signal_sources.pitot, 1.64, "gyro"),
    "fixed_height": (signal_sources.fixed_height, 0.02, "speed"),
    "vibration_alert": (accelerometer.vibration_alert, 1.3, "accel"),
    "other_answers": (transport.other_answers, 0.04, "speed"),
    "slope_overload": (transport.slope_overload, float(np.deg2rad(9.7)), "gyro"),
    "heading_jumps": (signal_sources.heading_jumps, float(2.0 * np.pi), "gyro"),
    "north_frame": (signal_sources.north_frame, float(np.deg2rad(15.0)), "gyro"),
    "fourier_blocks": (transport.fourier_blocks, 10.0, "accel"),
    "steering_play": (signal_sources.steering_play, 0.013, "gyro"),
    "supply_ripple": (electronics.supply_ripple, float(np.deg2rad(1.3)), "gyro"),
    "smoothed_fixes": (signal_sources.smoothed_fixes, 1.7, "gyro"),
    "other_gearbox": (speed.other_gearbox, 1.0, "speed"),
    "warm_gas": (accelerometer.warm_gas, 30.0, "accel"),
    "tin_whisker": (accelerometer.tin_whisker, 0.5, "accel"),
    "late_sign": (gyroscope.late_sign, 1.0, "gyro"),
    "momentum": (speed.momentum, 1.0, "speed"),
    "digits_as_hex": (transport.digits_as_hex, 1.0, "speed"),
    "few_components": (transport.few_components, 0.05, "accel"),
    "rim_accelerometer": (speed.rim_accelerometer, 2.23, "speed"),
    "coarse_ticks": (speed.coarse_ticks, 0.0156, "speed"),
    "magnetic_turns": (signal_sources.magnetic_turns, float(np.deg2rad(15.0)), "gyro"),
    "slow_passes": (accelerometer.slow_passes, 1.0, "accel"),
    "held_at_one_end": (carriers.held_at_one_end, 0.0067, "gyro"),
    "running_median": (transport.running_median, 5.0, "speed"),
}
"""Effect, medium size [SI], signal that must be there."""
