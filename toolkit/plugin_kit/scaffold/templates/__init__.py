"""One working implementation a stage; `Template` and `template` become the new plugin's names."""
