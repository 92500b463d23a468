"""Records, systems, responses and fits as other tools have them."""
