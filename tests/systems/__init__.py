"""Systems whose motions, derivatives or exponents are known exactly, against which methods are tested."""
