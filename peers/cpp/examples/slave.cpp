// A slave with a spring of 300 N/m behind 20 mm. First: slave [PORT]. Then: hapticnet master --connect 127.0.0.1:47800
#include <arpa/inet.h>
#include <cstdio>

#include "hapticnet.hpp"

int main(int argc, char **argv)
try {
    hapticnet::Slave slave("spring");

    int port = 47800;
    char rest; // after the number there must be nothing
    if ((argc > 1 && std::sscanf(argv[1], "%d%c", &port, &rest) != 1) || port < 1 || port > 65535)
        throw hapticnet::Error("usage: slave [PORT]");
    sockaddr_in here{}, from{};
    here.sin_family = AF_INET;
    here.sin_port = htons(static_cast<std::uint16_t>(port));
    here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    int door = socket(AF_INET, SOCK_DGRAM, 0);
    if (bind(door, reinterpret_cast<sockaddr *>(&here), sizeof here) != 0)
        throw hapticnet::Error("this port is taken; name another one");

    std::uint8_t data[hapticnet::RECEIVE_BYTES];
    for (;;) {
        // Receive all that has arrived, and only then answer the newest position.
        const auto position_m = slave.position();
        socklen_t length = sizeof from;
        auto *address = reinterpret_cast<sockaddr *>(&from);
        const ssize_t size = recvfrom(door, data, sizeof data, position_m ? MSG_DONTWAIT : 0, address, &length);
        if (size >= 0) {
            const auto answer = slave.receive(data, static_cast<std::size_t>(size), &from, length, hapticnet::now());
            if (answer)
                sendto(door, answer.data(), answer.size(), 0, address, length);
        } else if (position_m) {
            const double x_m = (*position_m)[0];
            const auto answer = slave.answer({x_m > 0.02 ? 300.0 * (x_m - 0.02) : 0.0}, hapticnet::now());
            const auto [master, master_size] = slave.master();
            if (answer)
                sendto(door, answer.data(), answer.size(), 0, static_cast<const sockaddr *>(master),
                       static_cast<socklen_t>(master_size));
        }
    }
} catch (const hapticnet::Error &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
}
