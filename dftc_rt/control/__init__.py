"""Control: the blocks of the paper on flat arrays, and the laws composed of them."""
