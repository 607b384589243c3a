"""What the signals of a drive should show of each other, by physics alone.

A drive is read against a model file (`reading`), put into the equations (`motion`, with their parts
in `kinematics` and `single_track`), and the residual and its columns come out block by block
(`forward`). Nothing here knows of statistics. Modules here use `signals`, `causes` and `cause_keys`
of the room above. Everyone else in `diagnosis` may call them.
"""
