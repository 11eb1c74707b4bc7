"""A plant of another structure: what real diesels do and the model's equations do not say, each form with an amplitude.

The forms were written and frozen before anything that corrects a model for them. Each depends on an input that a curve over the
component's own inputs lacks, or is finer than the knots of such a curve.
"""
