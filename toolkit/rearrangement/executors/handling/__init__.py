"""What an arm does with an object in its hand."""
