"""The main job: every case by every method, errors against run times, on one page and as data."""
