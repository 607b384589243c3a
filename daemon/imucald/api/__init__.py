"""The Python API behind `import imucald`: settings in, results out; it prints and asks nothing.

`configuration` loads, `replaying` runs logs through the engine, `drive` is what comes of one, with
its `tables` (one per rate) and `mount`. The names that count stand in `imucald.__all__`; this room
may change. The command line is made of it.
"""
