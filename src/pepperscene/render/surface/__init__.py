"""How surfaces scatter light, and the tables that describe them on the device."""
