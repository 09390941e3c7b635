// Says what is wrong with wrong uses, one line for each.
using System;
using System.Threading;
using Hapticnet;

/// A hand that stays where it is; it may fail after some ticks.
internal sealed class Nothing : IHand
{
    internal int Ticks, FailsAfter = int.MaxValue;

    public void Read(double[] positionM)
    {
        if (Ticks++ >= FailsAfter)
            throw new InvalidOperationException("no device");
    }

    public void Apply(double[] forceN)
    {
    }
}

internal static class Wrong
{
    private static void Say(Action use)
    {
        try
        {
            use();
            Console.WriteLine("fine");
        }
        catch (HapticException error)
        {
            Console.WriteLine(error.Message);
        }
    }

    /// The hand fails: the link says so, and a second Dispose does nothing.
    private static void Fail()
    {
        using (var scene = new SlaveLink("127.0.0.1", 0, "nothing", 1, new Air()))
        {
            var link = new MasterLink("127.0.0.1", scene.Port, new Request(), new Nothing { FailsAfter = 300 });
            for (int left = 100; left > 0 && link.Failure == null; left--)
                Thread.Sleep(50);
            Console.WriteLine(link.Failure);
            link.Dispose();
            link.Dispose();
        }
    }

    /// The scene fails: both ends say so, and the master's session is over at once.
    private static void FailAtSlave()
    {
        using (var scene = new SlaveLink("127.0.0.1", 0, "nothing", 1, new Air { Left = 100 }))
        using (var link = new MasterLink("127.0.0.1", scene.Port, new Request(), new Nothing()))
        {
            for (int left = 100; left > 0 && link.State != SessionState.Closed; left--)
                Thread.Sleep(50);
            Console.WriteLine(scene.Failure);
            Console.WriteLine(link.State + ": " + link.Reason);
        }
    }

    private sealed class Air : IScene
    {
        internal int Left = int.MaxValue;

        public void Touch(double[] positionM, double[] forceN)
        {
            if (Left-- == 0)
                throw new InvalidOperationException("no scene");
        }
    }

    private static void Main()
    {
        Say(() => new Master(new Request { RateHz = 5.0 }));
        Say(() => new Master(new Request { Codec = "deadbnad" }));
        Say(() => new Master(new Request { Name = new string('x', 65) }));
        Say(() => new Master(new Request { Axes = 4 }));
        Say(() => new Master(new Request { Axes = -1 }));
        Say(() => new Master(new Request { Parameters = { { "stepn", 0.1 } } }));
        Say(() => new Master(new Request { Parameters = { { "step_n", 0.1 } } }).Dispose());
        Say(() => new Slave("spring", 0));
        Say(() => PrivateKey.Parse("abc"));
        Say(() => new PrivateKey(new byte[31]));
        Say(() => PrivateKey.Load("/nonexistent/key.toml"));
        Say(() => ListedMaster.Load("/nonexistent/masters.toml"));
        Say(() => new Master(new Request()).Seal(new PrivateKey(new byte[32]), new byte[32]));
        Say(() => new Master(new Request { Axes = 2 }).Tick(new double[1], 0));
        Say(() => new Master(new Request()).Send(new byte[100]));
        Say(() => new Master(new Request()).Receive(new byte[3], 4, 0));
        Say(() => new Slave("spring").Receive(new byte[3], 3, new byte[40], 40, 0, new byte[Node.DatagramBytes]));
        Say(() => new MasterLink("nowhere.invalid", 47800, new Request(), new Nothing()));
        Say(() => new MasterLink("127.0.0.1", 0, new Request(), null));
        Say(() => new MasterLink("127.0.0.1", 47800, new Request(), null));
        Fail();
        FailAtSlave();
        Say(() => new SlaveLink("127.0.0.1", 99999, "nothing", 1, new Air()));
        Say(() => new SlaveLink("127.0.0.1", 0, "nothing", 1, null));
        Say(() =>
        {
            var master = new Master(new Request(), () => { throw new InvalidOperationException("no entropy"); });
            master.Tick(0);
        });
    }
}
