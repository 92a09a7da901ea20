"""pytester runs the scratch projects of the tests of our pytest plugin."""

pytest_plugins = ["pytester"]
