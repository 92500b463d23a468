"""Stages of a study: what each needs, computes and shows; `listing` has them all."""
