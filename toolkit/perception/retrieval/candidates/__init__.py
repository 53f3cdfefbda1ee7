"""How far views are apart, and the order in which candidates are tried."""
