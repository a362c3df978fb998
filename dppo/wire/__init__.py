"""Messages between learner and workers, their bytes, and the links that carry them."""
