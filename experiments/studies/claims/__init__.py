"""The paper's claims beside our results: `python -m studies.claims` writes a page and its pictures.

Every row is one run for each of some seeds, in virtual time, so the page can be regenerated at any time with the same
result.
"""
