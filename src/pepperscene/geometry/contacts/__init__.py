"""Contacts between organs: finding them, and turning organs until they are free of each other."""
