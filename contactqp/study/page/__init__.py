"""The report as one HTML page that needs nothing beside it: no network, no other file.

formulation     the problem of a case in mathematics, with its sizes
schemes         the equations of the schemes in time
case_view       what the page says of a case, in words and tables
render          render(data, overview, by_case): all of it into the templates
"""
