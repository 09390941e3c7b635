//! A slave with a spring of 300 N/m behind 20 mm.
//! First: cargo run --example slave [PORT]. Then: hapticnet master --connect 127.0.0.1:47800

use std::error::Error;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::Instant;

use hapticnet::{Slave, RECEIVE_BYTES};

fn main() {
    if let Err(error) = run() {
        eprintln!("{}", error);
        std::process::exit(2);
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let port = std::env::args().nth(1).unwrap_or_else(|| "47800".into()).parse().map_err(|_| "usage: slave [PORT]")?;
    let door = UdpSocket::bind((Ipv4Addr::LOCALHOST, port))?;
    let mut slave = Slave::new("spring", 1, None)?;
    let start = Instant::now();
    let now_us = || start.elapsed().as_micros() as i64;
    let mut data = [0; RECEIVE_BYTES];
    loop {
        // Receive all that has arrived, and only then answer the newest position.
        let position = slave.position();
        door.set_nonblocking(position.is_some())?;
        if let Ok((size, from)) = door.recv_from(&mut data) {
            if let Some(answer) = slave.receive(&data[..size], from.to_string().as_bytes(), now_us()) {
                door.send_to(&answer, from)?;
            }
        } else if let Some([x_m, ..]) = position {
            let answer = slave.answer(&[(300.0 * (x_m - 0.02)).max(0.0)], now_us());
            let master = slave.master().map(String::from_utf8_lossy);
            if let (Some(answer), Some(master)) = (answer, master) {
                door.send_to(&answer, master.parse::<SocketAddr>()?)?;
            }
        }
    }
}
