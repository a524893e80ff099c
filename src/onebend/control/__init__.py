"""Forces that bend a beam where it is wanted."""
