"""Statistics of colours and hue angles, with confidence intervals."""
