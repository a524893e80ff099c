"""Which push to make next: Fisher information, candidates, and what each would leave of the band."""
