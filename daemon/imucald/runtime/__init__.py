"""From frames on the bus to corrected frames: read it in this order.

1. `session` makes a configuration ready to run: router, estimator, consumers and output
   as one engine.
2. `engine` takes frames, live one by one or replayed in columns, and gives the frames to send.
   `timebase` turns their stamps into stream time.
3. `pipeline` gathers samples into ticks, for the estimator that `estimators` chose from the
   settings.
4. `consumer` is what else may take corrected samples; `consumers` has those there are.
5. `output` encodes: `output_frames` and those next to it, each of `output_message`.

`replay` runs recorded logs through an engine, `summary` says what came of a run. Nothing here
opens a bus or reads a clock (but a replay in real time); the running daemon is `imucald.service`.
"""
