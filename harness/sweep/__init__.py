"""Many runs of one scenario with values that vary, and their store."""
