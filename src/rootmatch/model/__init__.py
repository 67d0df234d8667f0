"""Models of what is observed: evidence of a hypothesis against clutter alone, and the posterior over hypotheses.

The image of a body: `detection_model` says what is known of the body and the image, `evidence` weighs hypotheses (an
assignment with its pose each), `posterior` turns those of one body into probabilities and `competition` those of
several bodies that compete for detections, by the `joint` hypotheses of all. Poses and assignments come from the layers
above. Two point sets in space: `point_set_model`, `shown_regions`, `weighed_labellings`, `labelling_sums`,
`point_set_posterior` and `point_set_bodies`. Bodies and sources that may be exactly symmetric: `exact_symmetry`.
"""
