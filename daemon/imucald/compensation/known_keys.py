"""The keys of a model file, and what becomes of each while driving.

The model file's own types stand in `imucald.simulation`; loading them would cost the daemon's start
more than all else that the file is for. A test holds these names against them.
"""

from __future__ import annotations

_MESSAGE = "enabled rate_hz delay_s jitter_s clock_drift_ppm loss dropouts stuck"
_TRIAD = (
    f"{_MESSAGE} noise_density bias bias_temperature bias_walk scale cross_axis lowpass_hz "
    "full_scale lsb vibration"
)
_SCALAR = f"{_MESSAGE} offset scale noise lsb lowpass_hz"

KNOWN: dict[str, frozenset[str]] = {
    section: frozenset(names.split())
    for section, names in {
        "suspension": "squat_dive squat_gradient dive_gradient pitch_frequency_hz pitch_damping "
        "body_roll roll_gradient roll_frequency_hz roll_damping heave_frequency_hz heave_damping "
        "wheel_hop_hz unsprung_ratio",
        "chassis": "mass_kg yaw_inertia_kgm2 wheelbase_m cg_to_front_m track_m steering_ratio "
        "rear_cornering_stiffness_npr understeer_gradient friction tyre_saturation single_track",
        "road": "grade grade_rms grade_mean grade_length_m bank crown_mean bank_rms bank_length_m "
        "superelevation superelevation_max roughness roughness_n0",
        "mount": "roll_deg pitch_deg yaw_deg lever_arm lever_arm_m shifts",
        "accel": f"{_TRIAD} vibration_mps2 engine_mps2",
        "gyro": f"{_TRIAD} g_sensitivity vibration_radps",
        "mag": f"{_MESSAGE} field_horizontal_t field_down_t hard_iron_t noise_t lsb",
        "speed": f"{_MESSAGE} scale lsb dead_band_mps noise_mps time_constant_s "
        "delay_rate",
        "wheel_speeds": f"{_MESSAGE} scale lsb dead_band_mps noise_mps slip_per_mps2 slip_events "
        "slip_event_size",
        "steering": _SCALAR,
        "yaw_rate": _SCALAR,
        "lateral_accel": _SCALAR,
        "longitudinal_accel": _SCALAR,
        "heading": _SCALAR,
        "reverse": _MESSAGE,
        "brake": _MESSAGE,
        "temperature": f"{_MESSAGE} start_degc rise_k time_constant_s lsb",
    }.items()
}
"""Sections whose keys are looked at, with all keys that they have."""
OTHERS = frozenset({"grid_hz", "route", "bus", "known_to"})
"""What only a simulated drive needs."""
