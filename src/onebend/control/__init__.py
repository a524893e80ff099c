"""Forces that bend a known beam as wanted."""
