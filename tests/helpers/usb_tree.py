"""A made-up machine's file system, as far as the checks of ``duplex doctor`` read it."""


def plug_in(root, serial="000123", product="097c", speed=5000, number=7, vendor="045e"):
    """Puts a depth camera on a made-up machine's bus, as Linux shows it."""
    entry = root / "sys/bus/usb/devices" / f"2-{number}"
    entry.mkdir(parents=True)
    content = {"idVendor": vendor, "idProduct": product, "serial": serial, "busnum": 2, "devnum": number}
    content["speed"] = speed
    for name, text in content.items():
        (entry / name).write_text(f"{text}\n")
    node = root / "dev/bus/usb/002" / f"{number:03d}"
    node.parent.mkdir(parents=True, exist_ok=True)
    node.touch()
    return node


def furnish(root):
    """Adds the files to a made-up machine that sensors and tracker need besides their libraries."""
    for file in (
        "usr/bin/dnn_model_2_0_op11.onnx",
        "usr/lib/x86_64-linux-gnu/libk4a1.4/libdepthengine.so.2.0",
        "proc/driver/nvidia/version",
    ):
        (root / file).parent.mkdir(parents=True)
        (root / file).touch()
