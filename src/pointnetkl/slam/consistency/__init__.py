"""How far maps agree with themselves."""
