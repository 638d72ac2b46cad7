"""Forward model of a fit: views of organs, observables, reflectance spectra and residuals."""
