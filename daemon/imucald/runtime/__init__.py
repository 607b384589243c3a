"""From frames on the bus to corrected frames. Read the modules in this order.

1. `session` builds one engine from a configuration: router, estimator, consumers and output.
2. `engine` takes frames, live one by one or replayed in columns, and returns the frames to send.
   `timebase` turns their stamps into stream time.
3. `pipeline` gathers samples into ticks, for the estimator that `estimators` chose from the
   settings.
4. `consumer` is the interface for other users of corrected samples; `consumers` has the existing
   ones.
5. `output` encodes: `output_frames` and the modules of its folder, each made of `output_message`.

`replay` runs recorded logs through an engine, and `summary` gives the result of a run. Nothing here
opens a bus or reads a clock, except for a replay in real time. The running daemon is
`imucald.service`.
"""
