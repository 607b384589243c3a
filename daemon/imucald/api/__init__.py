"""The Python API behind `import imucald`. Its functions return results and never print.

`configuration` loads a configuration. `replaying` runs logs through the engine. `drive` contains
the result of one drive, with its `tables` (one per rate) and its `mount`. The public names are
listed in `imucald.__all__`; other names in this package may change. The command line uses this
package.
"""
