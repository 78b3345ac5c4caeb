"""Where the fibre of a winder lies: mandrels, product files, and the replay of a program."""
