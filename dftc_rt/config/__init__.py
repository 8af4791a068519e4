"""Configuration: strict TOML to frozen typed structures."""
