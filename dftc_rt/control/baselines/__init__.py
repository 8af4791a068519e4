"""Laws to compare with, one file each."""
