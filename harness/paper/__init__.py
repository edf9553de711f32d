"""The paper's figures and numbers beside those of runs."""
