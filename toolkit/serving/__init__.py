"""`toolkit serve`: a session over HTTP on this machine.

uploads.py   a client's zip or picture -> a scene folder      door.py   how much and how many may come in at once
desk.py      what is done with them; the last answer          app.py    the addresses, and the page
"""
