"""The sensors of a scene file."""

from jaxrelight.errors import InputError
from jaxrelight.files.toml_table import Table
from jaxrelight.geometry.sensors import Sensor, sensor_grid


def read_sensors(root: Table) -> tuple[Sensor, ...]:
    """Every [[sensor]] of a scene file.

    Raises:
        InputError: for points and a grid together, neither of them, two sensors of one name, and whatever their numbers
            may not be, by name.
    """
    sensors: list[Sensor] = []
    for table in root.tables("sensor"):
        try:
            sensor = _sensor(table)
            if sensor.name in [other.name for other in sensors]:
                raise InputError(f"there is a sensor '{sensor.name}' already; give this one another name")
        except InputError as error:
            raise table.within(error) from None
        sensors.append(sensor)
        table.finish()
    return tuple(sensors)


def _sensor(table: Table) -> Sensor:
    name, normal = table.text("name"), table.array("normal", (3,), (0.0, 1.0, 0.0))
    if table.has("points") == table.has("origin"):
        raise InputError("give either 'points' or a grid: 'origin', 'u', 'v', 'columns' and 'rows'")
    if table.has("points"):
        points = table.get("points")
        if not isinstance(points, list) or not points:
            raise InputError(f"'points' must be a list of [x, y, z], not {points!r}")
        return Sensor(name, table.array("points", (len(points), 3)), normal)
    corner, u, v = (table.array(key, (3,)) for key in ("origin", "u", "v"))
    return sensor_grid(name, corner, u, v, table.whole("columns"), table.whole("rows"), normal)
