"""Evaluation of thousands of logs from hundreds of vehicles: each log is evaluated separately, then
all results are analysed together."""
