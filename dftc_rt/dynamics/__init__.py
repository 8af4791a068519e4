"""Rigid-body dynamics: robots from URDFs, the split of eq. (36). The one importer of pinocchio."""
