"""Direct evidence from samples, time stamps and stops, before any fit.

`faults` (with `stuck`) uses samples and time stamps. `stops` measures the gyroscope's zero error at
stops. `single_values`, `levels` and `successive` use raw values; the last two compare them with the
raw values of the model file's own drives. Modules in this package never call `search`.
"""
