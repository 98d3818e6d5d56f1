import numpy as np
import pytest

from fbench.pipelines.sensors.camera.layouts import COCO_80, labels_by_name, parse_names, translate
from fbench.replay.contracts.errors import ModelError


def test_names_as_dict_or_list() -> None:
    assert parse_names("{0: 'person', 2: 'car'}") == {0: "person", 2: "car"}
    assert parse_names("['a', 'b']") == {0: "a", 1: "b"}


@pytest.mark.parametrize(
    "text",
    ["__import__('os').getcwd()", "{0: 1}", "{'0': 'car'}", "7", "{}", "{0: 'car'", "(" * 5000, "", "{[0]: 'car'}"],
)
def test_names_that_are_anything_else_are_refused_and_never_run(text: str) -> None:
    with pytest.raises(ModelError, match="isn't a dict or list of class names"):
        parse_names(text)


@pytest.mark.parametrize("key", [10**30, -1, 1_000_001])
def test_class_ids_out_of_all_bounds_are_refused(key: int) -> None:
    with pytest.raises(ModelError, match="class ids must be between 0 and 1000000"):
        parse_names(f"{{{key}: 'car'}}")


def test_names_become_labels_and_others_are_dropped() -> None:
    assert labels_by_name({0: "Person", 1: "kite", 4: "van", 9: "motorbike"}) == {
        0: "pedestrian",
        4: "van",
        9: "motorcycle",
    }


def test_a_model_without_road_users_is_refused() -> None:
    with pytest.raises(ModelError, match=r"no class of the model is a road user \(its names begin with 'kite'\)"):
        labels_by_name({0: "kite"})


def test_translate_masks_unknown_classes() -> None:
    text, known = translate(np.array([2, 0, 4, 79, -1, 7]), COCO_80)
    assert known.tolist() == [True, True, False, False, False, True]
    assert text[known].tolist() == ["car", "pedestrian", "truck"]
