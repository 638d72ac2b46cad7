"""Light transport: samples, tracing, accumulation, adaptive sampling and denoising.

Light is traced and stored in two parts:

- Direct light: the flash at the first hit, the sky seen directly, and the sun at the first hit where it casts
  visible shadows. It has sharp edges (shadows, highlights, veins) and gets more samples where these are.
- Indirect light: all the rest, which is daylight on surfaces and light that was scattered more than once. It
  is small and smooth, and goes through the denoiser.
"""
