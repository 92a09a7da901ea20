"""From a problem to a certified solution: `solve`, its methods and its algorithms of friction."""
