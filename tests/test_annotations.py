"""That annotations are checked here, where tests call one thing."""

import jaxtyping
import pytest
import torch

from deep_curiosity.nn.statistics import RunningMoments


@pytest.mark.parametrize("repeated", [False, True])
def test_a_tensor_of_another_shape_than_annotated_is_refused_with_the_first_parameters(repeated):
    assert jaxtyping.config.jaxtyping_disable == repeated
    if not repeated:
        with pytest.raises(jaxtyping.TypeCheckError, match="value"):
            RunningMoments(3).update(torch.zeros(2, 2, 3))
