"""Where the residual is, and whether something is left unexplained."""
