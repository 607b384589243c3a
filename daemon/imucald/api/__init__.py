"""The Python API behind `import imucald`. The package takes settings and returns results; it never
prints.

`configuration` loads a configuration. `replaying` runs logs through the engine. `drive` holds the
result of one drive, with its `tables` (one per rate) and its `mount`. The public names are listed
in `imucald.__all__`; other names in this package may change. The command line uses this package.
"""
