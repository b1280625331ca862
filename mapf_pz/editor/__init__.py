"""The instance editor: a local server whose page edits maps and scenarios, and runs solvers.

It imports everything but the commands. Read `server.py` first.
"""
