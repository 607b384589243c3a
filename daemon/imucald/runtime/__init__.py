"""From frames on the bus to corrected frames. Read the modules in this order.

1. `session` builds one engine from a configuration: router, estimator, consumers and output. 2.
`engine` takes frames, live one by one or replayed in columns, and returns the frames to send.
`timebase` converts their time stamps to stream time. 3. `pipeline` collects samples in ticks and
passes the ticks to the estimator. `estimators` makes this estimator from the settings. 4.
`consumer` is the interface for other users of corrected samples; `consumers` contains the existing
users. 5. `output` encodes frames: `output_frames` and the other modules of this folder use
`output_message` for each message.

`replay` runs recorded logs through an engine, and `summary` gives the result of a run. Nothing here
opens a bus or reads a clock, except for a replay in real time. The running daemon is
`imucald.service`.
"""
