"""Direct evidence from samples, time stamps and stops, before any fit.

`faults` (with `stuck`, `held_speed`, `lost_readings`) uses samples and time stamps. `direct`
measures the gyroscope's zero error at stops. `levels`, `held_values` and `sample_changes` use raw
values and compare them with the raw values of the model file's own drives. Modules in this package
never call `search`.
"""
