"""The parameters that come with the package: few, of the right shapes, and they say where they are from."""

from __future__ import annotations

import json
from importlib.resources import files

import numpy as np

from server.pedestrian.activities import CLASSES, FEATURES, ORIGIN, ActivityModel, default_model


def test_the_model_that_comes_with_the_package_says_where_it_is_from() -> None:
    document = json.loads(files("server.pedestrian").joinpath("activity_model.json").read_text("utf-8"))
    assert document["origin"] == ORIGIN
    assert default_model().to_json() == document


def test_its_parameters_fit_the_features() -> None:
    model = default_model()
    assert model.mean.shape == model.deviation.shape == (len(FEATURES),)
    assert model.weights.shape == (len(CLASSES), len(FEATURES) + 1)
    assert (model.deviation > 0.0).all()
    odds = model.probabilities(np.random.default_rng(0).normal(scale=5.0, size=(50, len(FEATURES))))
    np.testing.assert_allclose(odds.sum(axis=1), 1.0)
    again = ActivityModel.from_json(json.loads(json.dumps(model.to_json())))
    np.testing.assert_array_equal(again.weights, model.weights)
