"""One joint estimate of how both sensors respond to the vehicle's motion: a matrix and a zero for
each.
"""
