//! A master that moves in and out of a scene for five seconds, and prints what a hand would feel.
//! First: hapticnet slave --scene paper. Then: cargo run --example master [HOST:PORT [SECONDS]]

use std::error::Error;
use std::net::UdpSocket;
use std::thread::sleep;
use std::time::{Duration, Instant};

use hapticnet::{Master, Request, State, RECEIVE_BYTES};

const USAGE: &str = "usage: master [HOST:PORT [SECONDS]]";

fn main() {
    if let Err(error) = run() {
        eprintln!("{}", error);
        std::process::exit(2);
    }
}

fn run() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let slave = arguments.next().unwrap_or_else(|| "127.0.0.1:47800".into());
    let seconds: f64 = arguments.next().unwrap_or_else(|| "5".into()).parse().map_err(|_| USAGE)?;
    let mut master = Master::new(&Request { name: "smallest".into(), ..Request::default() }, None)?;
    let link = UdpSocket::bind("0.0.0.0:0")?;
    link.connect(&slave).map_err(|error| format!("{}: {}; {}", slave, error, USAGE))?;
    link.set_nonblocking(true)?;

    let start = Instant::now();
    let now_us = || start.elapsed().as_micros() as i64;
    let mut data = [0; RECEIVE_BYTES];
    for tick in 0u64.. {
        sleep(Duration::from_millis(tick).saturating_sub(start.elapsed()));
        while let Ok(size) = link.recv(&mut data) {
            master.receive(&data[..size], now_us());
        }
        let x_m = 0.015 * (1.0 - (std::f64::consts::TAU * tick as f64 * 1e-3 / seconds).cos());
        master.tick(Some(&[x_m]), now_us());
        let force_n = master.force(now_us())[0]; // what a device would apply
        if tick % 100 == 0 {
            println!("{:6.2} mm {:6.2} N  {:?}", x_m * 1e3, force_n, master.state());
        }
        if tick == (seconds * 1e3) as u64 {
            master.close("done", now_us());
        }
        while let Some(datagram) = master.send() {
            let _ = link.send(&datagram); // if it fails, it is lost, as on the way
        }
        if master.state() == State::Closed {
            break;
        }
    }
    Ok(())
}
