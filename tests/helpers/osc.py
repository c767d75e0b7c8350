"""Open Sound Control as another library reads it."""

from pythonosc import osc_packet


def messages(datagrams):
    """Address and arguments, as python-osc reads them."""
    read = [m.message for d in datagrams for m in osc_packet.OscPacket(d).messages]
    return [(message.address, list(message.params)) for message in read]
