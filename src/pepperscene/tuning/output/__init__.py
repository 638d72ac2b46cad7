"""Files and tables that describe a fit."""
