"""``hapticnet device find``: list serial ports and mark those that may be the device."""

from hapticnet import options


def find(json: options.Json = False) -> None:
    """List the serial ports of this host in the form that other commands take."""
    from dataclasses import asdict

    from hapticnet.cli.console import deliver, show
    from hapticnet.runtime.serial_port import find_ports

    ports = find_ports()
    if json:
        listed = [{"device": f"serial:{port.path}", **asdict(port)} for port in ports]
        deliver({"ports": listed, "auto": sum(port.likely is not None for port in ports) == 1}, as_json=True, file=None)
        return
    for port in ports:
        what = ", ".join(filter(None, (port.description, port.serial_number)))
        show(f"serial:{port.path}  {what or port.name}  ({port.likely or 'no sign of a Nano'})")
    likely = sum(port.likely is not None for port in ports)
    if likely == 1:
        print("the first may be the device; serial:auto finds it")
    elif likely:
        print(f"the first {likely} may be the device; choose one")
    else:
        print("no port looks like an Arduino Nano; is it plugged in?")
