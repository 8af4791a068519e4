"""The paper's two examples in continuous time: what reproduces, and what does not."""
