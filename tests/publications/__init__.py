"""Methods A to D once more, written from the publications alone: what the package is held against.

No module here imports the package; the tests beside them import both.
"""
