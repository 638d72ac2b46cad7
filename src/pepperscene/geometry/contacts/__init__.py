"""Contacts between organs: detection, and rotations of organs that resolve them."""
