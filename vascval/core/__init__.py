"""The tree and what is true of every tree; knows no file, no image and no plot."""
