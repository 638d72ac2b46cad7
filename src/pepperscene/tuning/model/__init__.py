"""The forward model of a fit: views of organs, observables and residuals."""
