"""Scalar jitted functions without allocation or errors, called by the CPU and the GPU alike."""
