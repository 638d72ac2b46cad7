"""Light transport: samples, tracing, accumulation, adaptive sampling and denoising."""
