"""Direct evidence from samples, time stamps and stops, before any fit.

`faults` (with `stuck`, `held_speed`, `lost_readings`) reads samples and stamps. `direct`
reads the gyroscope's zero at stops. `levels`, `held_values` and `sample_changes` read raw values,
and compare them with those of the model file's own drives. Modules here never call `search`.
"""
