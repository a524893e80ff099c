"""What a batch says of the populations that its objects were drawn from: `onebend population`."""
