//! What is wrong is one sentence; and what the types promise.

use std::path::Path;

use hapticnet::{codecs, load_masters, parse_key, Master, PrivateKey, Request, Slave};

fn refusal(change: impl FnOnce(&mut Request)) -> String {
    let mut request = Request::default();
    change(&mut request);
    Master::new(&request, None).err().map_or("fine".into(), |error| error.to_string())
}

#[test]
fn a_wrong_request_is_refused_with_the_text_of_the_library() {
    assert_eq!(refusal(|_| ()), "fine");
    assert_eq!(refusal(|r| r.parameters = vec![("step_n".into(), 0.1)]), "fine");
    assert_eq!(refusal(|r| r.rate_hz = Some(5.0)), "rate_hz is 5; it must be between 20 and 100000");
    let wrong = refusal(|r| r.codec = "deadbnad".into());
    assert_eq!(wrong, format!("codec is 'deadbnad'; it must be one of {}", codecs().join(", ")));
    assert_eq!(refusal(|r| r.axes = 4), "axes is 4; it must be 1 to 3");
    assert_eq!(refusal(|r| r.name = "a\0b".into()), "the name has a zero byte");
    let wrong = refusal(|r| r.parameters = vec![("stepn".into(), 0.1)]);
    assert_eq!(wrong, "parameter is 'stepn'; it must be one of deadband's: step_n");
    assert_eq!(Slave::new("spring", 0, None).err().unwrap().to_string(), "axes is 0; it must be 1 to 3");
    assert!(Slave::new("spring", (1 << 32) + 1, None).is_err());
}

#[test]
fn a_wrong_key_is_refused() {
    let wrong = parse_key("abc").unwrap_err().to_string();
    assert_eq!(wrong, "a key is 44 characters of base64 that end in '=' (32 bytes); this has 3 characters");
    let missing = PrivateKey::load(Some(Path::new("/nonexistent/key.toml"))).err().unwrap().to_string();
    assert_eq!(missing, "/nonexistent/key.toml does not exist; 'hapticnet key new' makes a key");
    assert!(load_masters(Some(Path::new("/nonexistent/masters.toml"))).is_err());
    let mut master = Master::new(&Request::default(), None).unwrap();
    assert!(master.seal(&PrivateKey::new([1; 32], None), &[0; 32]).is_err());
}

#[test]
fn a_key_has_the_public_key_of_rfc_7748() {
    let own = *b"\x77\x07\x6d\x0a\x73\x18\xa5\x7d\x3c\x16\xc1\x72\x51\xb2\x66\x45\
        \xdf\x4c\x2f\x87\xeb\xc0\x99\x2a\xb1\x77\xfb\xa5\x1d\xb9\x2c\x2a";
    let public = PrivateKey::new(own, None).public().unwrap();
    assert_eq!(public[..4], [0x85, 0x20, 0xf0, 0x09]);
}

#[test]
fn a_node_moves_to_another_thread_and_draws_from_the_source_it_is_given() {
    let mut master = Master::new(&Request::default(), Some(Box::new(|| 0x0102_0304))).unwrap();
    let hello = std::thread::spawn(move || {
        master.tick(None, 0);
        master.send().unwrap().to_vec()
    });
    assert!(hello.join().unwrap().windows(4).any(|nonce| nonce == [1, 2, 3, 4]));
}

#[test]
#[should_panic(expected = "a position needs each axis")]
fn a_position_without_an_axis_is_a_mistake_of_the_program() {
    let request = Request { axes: 2, ..Request::default() };
    Master::new(&request, None).unwrap().tick(Some(&[0.0]), 0);
}
