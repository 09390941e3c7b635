"""A slave and a master in one asyncio program: a robot's force is felt over the network."""

import asyncio

import hapticnet as hn


class Robot:
    """Anything with ``step``: here a wall at 10 mm; yours asks its robot, engine or model."""

    def step(self, sample: hn.PositionSample) -> float:
        """Return the force [N] at a position [m]."""
        return max(0.0, 400.0 * (sample.position_m[0] - 0.01))


async def tell(master: hn.Master) -> None:
    """Print the events of the session: connected, link stale, ended and so on."""
    async for event in master.events():
        print(event)


async def main() -> None:
    """Push 5 mm into the wall, and change the codec on the way."""
    async with hn.Slave(Robot(), listen="127.0.0.1:0") as slave, hn.Master(slave.address, multiplier=2) as master:
        events = asyncio.create_task(tell(master))
        for step in range(301):
            (force_n,) = await master.exchange(0.015 * step / 300)
            if step == 200:
                master.change(codec="linear-predictive")
        await asyncio.sleep(0.1)
        print(f"{master.force_n[0]:.1f} N in front of the wall's {force_n:.1f} N")
    await events


if __name__ == "__main__":
    asyncio.run(main())
