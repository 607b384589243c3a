"""One model of the car: quantities, equations, and their evidence in windows."""
