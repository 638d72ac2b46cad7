"""From light to images: electrons, exposure, glare, colour."""
