"""What the guide needs of Sphinx beyond what Sphinx has."""
