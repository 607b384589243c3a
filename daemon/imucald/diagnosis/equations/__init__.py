"""Predict the signals of a drive from each other by physics alone.

`reading` reads a drive with a model file. `motion` evaluates the equations of the package `drive`.
`forward` returns the residuals and their columns block by block. This package uses no statistics.
The modules of this package use `signals`, `causes` and `cause_keys`. All other modules of
`diagnosis` may call this package.
"""
