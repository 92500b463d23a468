"""A structure matched to responses, with a certificate over the band."""
