"""The report as one HTML page that needs nothing beside it: no network, no other file.

formulation     the problem of a case in mathematics, with its sizes and the equations of its impact scheme
case_view       one case in words and tables; the safe ranges of the stability study as bars
render          the pages of a report and of the stability study, filled into the templates
"""
